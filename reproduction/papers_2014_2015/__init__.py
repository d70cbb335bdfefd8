"""The drawings of the articles on 2014 and 2015, and Table 4 of 2014."""
