"""Driving a camera through its GenICam nodes, whatever the transport."""
