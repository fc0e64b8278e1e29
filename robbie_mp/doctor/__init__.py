"""What is wrong with this machine for running robots: small checks, each a function of what it is shown.

Each module of this package holds `check_…` functions, which judge plain values and so can be shown any
machine, and a `look_at_…` function, which reads this machine and hands it to them.
`robbie_mp.doctor.examination` calls the latter.
"""
