"""Speed against accuracy, in development only: benchmarks, studies, the documentation's charts; not in the wheel."""

import os

# read when numpy is imported: a method's time is that of one thread, in which it would also wait for others
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
