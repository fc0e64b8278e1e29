"""Drivers on emulated devices, alone and in whole robots."""
