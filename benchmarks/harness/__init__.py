"""Named methods on named cases, in turns, timed and judged; peers over a pipe."""
