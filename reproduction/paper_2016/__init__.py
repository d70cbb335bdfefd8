"""Table 1 of 2016, what its percent can mean, and the drawings of its article."""
