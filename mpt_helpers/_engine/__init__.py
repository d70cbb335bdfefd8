"""How a filter runs over tracks; knows arrays and equations only.

`filter(z)` of a filter comes to `run.estimates`, and from there

- tracks without gaps go to `shared`: their steps A_k, B_k, P are made once, and several are taken in one product;
- all others are `columns`: x, P, innovations = advance(epoch, x, P), one epoch after the other;
- a long track is cut, and its `pieces` are columns: each is one Lainiotis step over many rows.

The way back of the `smoother` is columns, too. `algebra` has the products of many small matrices.
"""
