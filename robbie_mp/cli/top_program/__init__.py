"""The terminal program `robbie top`. No other part of the framework needs the library textual."""
