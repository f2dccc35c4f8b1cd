"""What the policy `metric-map` is made of: one idea per file, all pure."""
