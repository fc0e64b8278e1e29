"""The hot path in C. Each file is named after the Python file that says what it does."""
