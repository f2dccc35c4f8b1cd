"""The daemon as a service: systemd, signals, reloads, and what outlives a restart."""
