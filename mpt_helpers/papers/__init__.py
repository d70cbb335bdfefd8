"""What only one or two of the papers need."""
