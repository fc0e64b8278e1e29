"""What an author writes a module with, and what runs it."""
