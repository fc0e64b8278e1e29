"""The common parts of bridges to other systems: the messages that cross, their names, and driving."""
