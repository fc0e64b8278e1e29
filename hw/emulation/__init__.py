"""Emulated devices: they answer on a serial line or a TCP port as their makers' manuals say.

They try a driver without its hardware, and carry a simulation behind them. Each is written from the maker's
manual alone, so that it does not share a driver's mistakes.
"""
