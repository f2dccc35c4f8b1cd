"""Which policy would have served a drive best: a bracketed recording, exposed again for each policy in closed loop."""
