"""Teach and repeat in closed loop: a simulated robot that steers by what it sees."""
