"""What the host offers to cameras: its network, its USB, its memory."""
