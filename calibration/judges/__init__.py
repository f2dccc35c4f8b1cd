"""What is wrong with a sweep or its solution, one rule for each reason."""
