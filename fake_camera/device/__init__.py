"""The camera behind any protocol: what it does with triggers, settings and faults."""
