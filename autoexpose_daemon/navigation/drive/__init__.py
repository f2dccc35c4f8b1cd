"""Driving along a path: taught by somebody, then repeated."""
