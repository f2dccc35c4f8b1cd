"""What the policy `fisher-map` adds to `metric-map`: the objective, and the split of time and gain."""
