"""How a filter runs over tracks; knows arrays and equations only. `filter(z)` calls `run.estimates`: begin there."""
