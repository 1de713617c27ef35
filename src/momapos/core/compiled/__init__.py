"""Kernels: functions that numba compiles once and that then run without numba.

Importing numba takes 0.5 s, even to load compiled code. So the machine code of an entry (a kernel
that Python calls) is stored, with argument types fixed by its annotations, and llvmlite loads it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
