"""Modules that connect one device each with messages."""
