"""`autoexpose demo --navigate`: the fake cameras on a simulated robot that is taught a lap and repeats it."""
