"""What both the commands and the operator station show: messages as text, known types, the process table."""
