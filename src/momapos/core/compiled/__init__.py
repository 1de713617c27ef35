"""Kernels: functions that are compiled once and then run without the compiler.

numba compiles them, and takes half a second to import before it can even load what it compiled. So
an entry, a kernel that Python calls, is kept as machine code with its types fixed by its
annotations; llvmlite alone loads it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
