"""The program `robbie top` on a terminal. The only part of the framework that needs the library textual."""
