"""The operator station: a page, served by the robot, on which an operator sees and steers it.

It is a module like any other, in a separate process: a page server that hangs or dies takes nothing
else down. Needs the extra `gui`.
"""

from robbie_mp.station.station import ExtraMissing, OperatorStation, load_website

__all__ = ["ExtraMissing", "OperatorStation", "load_website"]
