"""The camera on USB3 Vision: the device behind a USB/IP server, and the shim through which libusb finds it."""
