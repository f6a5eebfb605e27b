"""Visual SLAM for drones: continual dictionary learning and sparse coding before RatSLAM."""

import os

# Before numpy is imported: the products here are bound by memory, and threads that share it would
# only take the cores from the other nodes. Whoever sets the variable decides.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
