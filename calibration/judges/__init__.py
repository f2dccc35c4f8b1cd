"""What is wrong with a sweep or its solution, each reason a rule of its own."""
