"""Table 1 of 2016, what its percent can mean, its figures, and the drawings of its lesson."""
