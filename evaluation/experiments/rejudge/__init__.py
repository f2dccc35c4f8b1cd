"""Whether a drive that was recorded in brackets ranks policies as driving with them does."""
