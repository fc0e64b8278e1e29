"""Checks whether this machine is suitable for running robots.

Each module of this package has `check_…` functions, which judge plain values and can therefore be tested for
any machine, and a `look_at_…` function, which reads the values from this machine. `examination` calls the
latter.
"""
