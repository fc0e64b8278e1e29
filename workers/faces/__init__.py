"""Recognition of persons by their faces."""
