"""Table 1 of 2016 and what its percent can mean, what affects the filter, figures, and the drawings of two lessons."""
