"""From a stereo pair to the next exposure: pure steps without threads, clocks and I/O."""
