"""Damage the bytes that devices send, and check that each decoder goes on."""
