"""Kernels: functions that are compiled once and then run without the compiler.

numba compiles them, and takes half a second to import before it can even load what it compiled. So
an entry, a kernel that Python calls, is kept as machine code with its types fixed by its
annotations; llvmlite alone loads it.
"""

from momapos.compiled.arrays import (
    B1,
    B2,
    C1,
    C2,
    F1,
    F2,
    F3,
    F4,
    I1,
    I2,
    I3,
    S2,
    S3,
    U1,
    U2,
    U3,
    U4,
    Array,
    ReadI8,
)
from momapos.compiled.kernel import Kernel, entry, kernel

__all__ = [
    "B1",
    "B2",
    "C1",
    "C2",
    "F1",
    "F2",
    "F3",
    "F4",
    "I1",
    "I2",
    "I3",
    "S2",
    "S3",
    "U1",
    "U2",
    "U3",
    "U4",
    "Array",
    "Kernel",
    "ReadI8",
    "entry",
    "kernel",
]
