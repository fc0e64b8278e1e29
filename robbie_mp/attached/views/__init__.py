"""Views that commands and the operator station share: messages as text, known types, the process table."""
