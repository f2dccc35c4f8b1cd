"""What each constant of a policy is worth: its courses with that constant altered."""
