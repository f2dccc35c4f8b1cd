"""The auto-exposure daemon: configuration, control, service and command line."""
