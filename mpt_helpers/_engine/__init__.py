"""How a filter runs over tracks; knows arrays and equations only.

`filter(z)` calls `run.estimates`, which runs

- tracks without gaps by `shared`: their steps A_k, B_k, P are made once, and several are taken in one product;
- all others as `columns`: x, P, innovations = advance(epoch, x, P), one epoch after the other;
- a long track in `pieces`, which are columns too: each is one Lainiotis step over many rows.

The backward pass of the `smoother` runs on columns as well. `algebra` has the products of many small matrices.
"""
