"""What every other room uses: errors, times as text, YAML with places, what Linux offers."""
