"""The stock robots as a library: `hw` (devices), `workers` (algorithms), `modules`, and `profiles`.

In the repository, these are links to the folders at its top, so that a checkout, a wheel, editors and type
checkers know everything by one name.
"""
