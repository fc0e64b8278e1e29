"""Inertial measurement units of MicroStrain."""
