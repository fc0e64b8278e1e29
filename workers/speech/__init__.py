"""Understands spoken orders, and speaks."""
