"""Modules that each connect one device to messages."""
