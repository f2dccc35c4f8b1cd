"""The camera behind any protocol: its triggers, settings and faults."""
