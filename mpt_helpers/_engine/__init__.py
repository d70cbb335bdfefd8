"""How a filter runs over tracks; knows arrays and equations only.

This is the way of z through `KalmanFilter.filter`:

    _base    Filter.filter   z as (N, m, M)
    kalman   epochs_of       with the time steps and variances of its epochs
    run      run_estimates   tracks without gaps share A_k, B_k and P, made by filterpy (`next_step`): see `shared`
             _on_columns     all others run side by side, as columns of arrays
    columns  Epochs.rows     row k: z, which of it is there, and F, Q and r where they are its own
    diffuse  run_rows_with_diffuse_starts
                             where P is diffuse, at the start or after a pause, several rows as one; else `run_rows`
    pieces   run_rows        one row after the other; a long track is cut into pieces, which run side by side
    kalman   advance         one row: predict x and P, then correct them by each measurement that is there
    columns  scalar_update   one measurement: S, gain, x and P

`step` is `next_step`, and filterpy's. `run_innovations` and `smoothed` (`smoother`) begin with `run_estimates`, too.
"""
