"""How a filter runs over tracks: it knows arrays and equations, and no model or filter."""
