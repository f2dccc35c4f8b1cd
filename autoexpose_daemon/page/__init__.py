"""The live page and Prometheus metrics: a process of its own, fed over zenoh."""
