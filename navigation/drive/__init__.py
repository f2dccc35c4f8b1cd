"""Driving along a path: taught by someone, then repeated."""
