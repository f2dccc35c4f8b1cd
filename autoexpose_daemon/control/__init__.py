"""From a stereo pair to the next exposure: pure steps without threads, clocks or I/O."""
