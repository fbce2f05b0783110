"""Compiled kernels that release the GIL.

The only place that speaks to numba's decorators, so that every kernel is compiled alike: no Python objects, no GIL,
kept on disk between runs where the disk allows it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: Final = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz", "reassoc"}}


def kernel(function: Function) -> Function:
    """Compile a function to machine code that runs without the GIL.

    The compiled code is cached beside the source, or in the user's cache folder; where neither can be written it is
    compiled anew in each process.
    """
    return _cached(partial(numba.njit, **_OPTIONS), function)


def lean_kernel(function: Function) -> Function:
    """Compile a kernel that works in the arrays it is given: it cannot allocate, and in return slices cost nothing.

    Without numba's runtime no reference is counted; counting them is what short loops over slices spend their time on.
    """
    return _cached(partial(numba.njit, _nrt=False, **_OPTIONS), function)


def _cached(compile_with: Callable[..., Any], function: Function) -> Function:
    try:
        return cast("Function", compile_with(cache=True)(function))
    except RuntimeError:  # numba's word for "no folder in which the cache could be written"
        return cast("Function", compile_with()(function))


def _prefetch(_: Any, array: Any, row: Any, col: Any) -> Any:
    """Ask for the memory of an array's element, which will be read soon; an address outside of it does no harm."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        indices = [
            context.cast(builder, value, given, numba.types.intp)
            for value, given in zip(arguments[1:], signature.args[1:], strict=True)
        ]
        place = cgutils.get_item_pointer(
            context, builder, kind, context.make_array(kind)(context, builder, arguments[0]), indices, wraparound=False
        )
        flag, byte = ir.IntType(32), ir.IntType(8).as_pointer()
        takes = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
        function = cgutils.get_or_insert_function(builder.module, takes, "llvm.prefetch.p0")
        read, keep, data = (flag(value) for value in (0, 3, 1))
        builder.call(function, [builder.bitcast(place, byte), read, keep, data])
        return context.get_dummy_value()

    return numba.types.void(array, row, col), build


prefetch = cast("Callable[[NDArray[Any], int, int], None]", intrinsic(_prefetch))
"""In a kernel: ask for the memory of array[row, col], which will be read soon."""
