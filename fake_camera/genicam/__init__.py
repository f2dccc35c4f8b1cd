"""The camera's GenICam face: its description, registers and chunks."""
