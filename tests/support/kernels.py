"""Which processor the tests run on, and which kernels of the numerical libraries it gets there.

Each library chooses among instruction sets when it is loaded, so that the last bits of what it
computes differ from machine to machine. An environment variable can ask each for an older set.
"""

import os
import platform

import numba
import numpy as np
import torch
from numba.core.registry import cpu_target
from threadpoolctl import threadpool_info

from training.measuring.machine import processor


def kernels() -> dict[str, str]:
    """Names of instruction sets by library, and the variable that changes each."""
    import scipy.linalg  # noqa: F401, loads its own BLAS

    _, name, features = cpu_target.target_context.codegen().magic_tuple()
    vectors = [one for one in ("avx512f", "avx2", "fma") if f"+{one}" in features.split(",")]
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    blas = {
        "{internal_api} {version} {architecture}, {num_threads} threads".format(**one)
        for one in threadpool_info()
        if one["user_api"] == "blas"
    }
    return {
        "processor": f"{processor()}, {os.cpu_count()} cores, glibc {platform.libc_ver()[1]}",
        f"numba {numba.__version__}": f"{name} {' '.join(vectors)} (NUMBA_CPU_NAME)",
        f"numpy {np.__version__}": " ".join([*simd["baseline"], *simd.get("found", [])])
        + " (NPY_DISABLE_CPU_FEATURES)",
        "BLAS": "; ".join(sorted(blas)) + " (OPENBLAS_CORETYPE)",
        f"torch {torch.__version__}": f"{torch.backends.cpu.get_cpu_capability()}, "
        f"{torch.get_num_threads()} threads (ATEN_CPU_CAPABILITY)",
    }
