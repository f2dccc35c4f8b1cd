"""IEEE 1588, the Precision Time Protocol (PTP): clocks, a slave in each camera, and a master."""
