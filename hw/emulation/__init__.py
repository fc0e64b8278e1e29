"""Emulated devices: they answer on a serial line or a TCP port as their makers' manuals say.

They try a driver without its hardware, and can carry a simulation behind them. Each was written without a
look at the driver, so that it does not share the driver's mistakes.
"""
