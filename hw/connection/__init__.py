"""Base of drivers of devices on a serial line or a TCP port."""
