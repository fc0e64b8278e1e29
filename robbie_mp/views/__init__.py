"""What commands and the operator station both show: messages as text, known types, the process table."""
