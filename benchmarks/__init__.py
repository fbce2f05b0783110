"""Speed against accuracy, in development only: benchmarks, studies, the documentation's charts; not in the wheel.

``python3 run.py bench NAME`` is ``python -m benchmarks NAME`` in the project's own environment; ``--help`` lists all.

- ``choices``, ``stability``, ``parsimony``: benchmarks, a module each, which ``harness`` runs: methods on cases with
  known truth, timed and judged. Charted are cost and error, failures by stress, and error by number of parameters.
- ``imperfect``: what each imperfection of an instrument costs, and many of them at once.
- ``studies``: measurements of accuracy; ``documents``: the charts and tables of the documentation, made from them.
- ``programs``: what is measured in processes and windows of its own, and deliberate mistakes that tests must notice.
- ``screens``: pictures of every panel (``python3 run.py screens``).
- ``rigs``: instruments, engines and photographs with known truth, which all of these look at.
"""

import os

# read when numpy is imported: a method's time is that of one thread, in which it would also wait for others
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
