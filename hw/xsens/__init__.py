"""Inertial measurement units of Xsens."""
