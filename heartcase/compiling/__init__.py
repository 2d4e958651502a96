"""How kernels are compiled: one decorator, its cache, and all that heartcase takes of numba's inside.

numba promises nothing of what lies below ``numba.core``: no other folder imports it. ``docs/numba.md`` says what breaks
when numba moves. Importing this package checks numba's version.
"""

from heartcase.compiling.versions import check_numba

check_numba()
