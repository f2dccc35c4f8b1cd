"""From a set of frames to the next exposure: pure steps without threads, clocks or I/O."""
