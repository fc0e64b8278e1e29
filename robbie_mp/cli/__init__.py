"""The command line: `robbie COMMAND …` and `robbie-top`.

Each command is a module of this package with `add_parser(subparsers)`, which gives its parser the default
`command`: a function from the parsed arguments to the exit code. It is imported only if it is asked for.
"""

# No code here: commands are named after built-ins (list) and the entry points below (top), and importing a
# command binds its name in this package.
from robbie_mp.cli.start import main, top

__all__ = ["main", "top"]
