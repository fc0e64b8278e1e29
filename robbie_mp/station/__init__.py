"""The operator station: a page, served by the robot, on which an operator sees and steers it.

It is a module like any other, in a process of its own: a page server that is stuck or dead takes nothing else
with it. Needs the extra `gui`.
"""

from robbie_mp.station.station import ExtraMissing, OperatorStation, load_website

__all__ = ["ExtraMissing", "OperatorStation", "load_website"]
