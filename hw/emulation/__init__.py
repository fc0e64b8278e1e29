"""Emulated devices: they answer on a serial line or a TCP port as their makers' manuals say.

They try a driver without its hardware, and can carry a simulation behind them. Those of bases, inertial units
and receivers were written without a look at the drivers, so that they do not share the drivers' mistakes. The
others were checked against programs by other authors.
"""
