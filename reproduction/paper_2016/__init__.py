"""Table 1 of 2016 and what its percent can mean, what affects the filter, the figures, and the lesson's drawings."""
