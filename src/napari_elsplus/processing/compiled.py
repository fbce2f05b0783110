"""Compilation of kernels by numba, all with the same options: nopython, without the GIL, cached on disk."""

from __future__ import annotations

import gc
import hashlib
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import numba
from llvmlite import ir
from numba.core import cgutils, event
from numba.extending import intrinsic, register_jitable

from napari_elsplus.processing.compilation import report_compilation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: Final = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "arcp", "nsz", "reassoc"},
    "no_cfunc_wrapper": True,  # of use to C alone, and a tenth of the compiler's work
}


def kernel(function: Function) -> Function:
    """Compile a function to machine code that releases the GIL.

    The machine code is cached beside the source, or in the user's cache folder; where neither can be written, each
    process compiles it again.
    """
    return _cached(partial(numba.njit, **_OPTIONS), function)


def lean_kernel(function: Function) -> Function:
    """Compile a function as :func:`kernel` does, without numba's runtime.

    It cannot allocate arrays. In return no references are counted, which is what short loops over slices would spend
    most of their time on.
    """
    return _cached(partial(numba.njit, _nrt=False, **_OPTIONS), function)


def resolved_once(function: Function) -> Function:
    """Return a kernel that resolves the types of its arguments at its first call only.

    At every call that takes 9 us for some thirty arrays in tuples, the call itself 1. Types of later arguments are not
    checked: arrays of another kind would be read as if they were of the first call's, and floats as integers.

    Parameters
    ----------
    function : callable
        A kernel.
    """
    machine_code: Callable[..., Any] | None = None

    def call(*arguments: Any) -> Any:
        nonlocal machine_code
        if machine_code is None:
            machine_code = cast("Any", function).compile(tuple(numba.typeof(argument) for argument in arguments))
        return machine_code(*arguments)

    return cast("Function", call)


def compilable(function: Function) -> Function:
    """Return a function as it is, and let kernels call it, compiled as :func:`lean_kernel` does.

    For functions of numbers, and for those that kernels alone call: they are not made callable from Python nor stored
    by themselves, which takes a tenth off the compilation of a registration. Kernels by :func:`kernel` or
    :func:`lean_kernel` and other compilable functions each compile it for themselves.
    """
    return register_jitable(_nrt=False, **_OPTIONS)(function)


def _cached(compile_with: Callable[..., Any], function: Function) -> Function:
    try:
        dispatcher = compile_with(cache=True)(function)
    except RuntimeError:  # raised by numba where no cache folder is writable
        return cast("Function", compile_with()(function))
    dispatcher._cache._cache_file._source_stamp = _sources_of_kernels()  # noqa: SLF001 - numba has no public way
    dispatcher.get_call_template = partial(_template_without_literals, dispatcher.get_call_template)
    return cast("Function", dispatcher)


def _template_without_literals(resolve: Callable[..., Any], args: Sequence[Any], kws: Mapping[str, Any]) -> Any:
    """Resolve a call between kernels by the types of its arguments: numba compiles a kernel anew for each constant."""
    kinds = {name: numba.types.unliteral(kind) for name, kind in kws.items()}
    return resolve(tuple(numba.types.unliteral(kind) for kind in args), kinds)


class _Compilations(event.Listener):
    """Reports the outermost kernel that is compiled; the compiler's lock keeps threads apart.

    Meanwhile Python collects no garbage: it would look through the compiler's many objects again and again, for an
    eighth of the time, and find little.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._collects = False

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._collects = gc.isenabled()
            gc.disable()
            report_compilation(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Any) -> None:
        del event
        self._depth -= 1
        if not self._depth:
            if self._collects:
                gc.enable()
            report_compilation("")


event.register("numba:compile", _Compilations())


@cache
def _sources_of_kernels() -> str:
    """Return a hash of the sources of all kernels of the package.

    Machine code of a kernel contains that of the kernels it calls, whereas numba compares the kernel's own file only.
    """
    package = Path(__file__).parents[1]
    texts = (path.read_bytes() for path in sorted(package.rglob("*.py")))
    marks = b"processing.compiled import", b"numba.extending import", b"llvmlite import"
    return hashlib.sha256(b"".join(text for text in texts if any(mark in text for mark in marks))).hexdigest()


def build_prefetch(builder: Any, place: Any) -> None:
    """Add the instruction that prefetches the cache line of an address, any of which is harmless, to a kernel.

    Into the second cache; measured: with the first one, the front end takes 70 instead of 52 us where frames are in no
    cache. Likely because more lines can be on their way to the second.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
        Of the kernel.
    place : llvmlite.ir.Value
        Pointer.
    """
    flag, byte = ir.IntType(32), ir.IntType(8).as_pointer()
    takes = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
    function = cgutils.get_or_insert_function(builder.module, takes, "llvm.prefetch.p0")
    read, second_cache, data = (flag(value) for value in (0, 2, 1))
    builder.call(function, [builder.bitcast(place, byte), read, second_cache, data])


def _prefetch(_: Any, array: Any, row: Any, col: Any) -> Any:
    """Prefetch the cache line of an array's element; an address outside of the array is harmless."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        indices = [
            context.cast(builder, value, given, numba.types.intp)
            for value, given in zip(arguments[1:], signature.args[1:], strict=True)
        ]
        place = cgutils.get_item_pointer(
            context, builder, kind, context.make_array(kind)(context, builder, arguments[0]), indices, wraparound=False
        )
        build_prefetch(builder, place)
        return context.get_dummy_value()

    return numba.types.void(array, row, col), build


prefetch = cast("Callable[[NDArray[Any], int, int], None]", intrinsic(_prefetch))
"""Prefetch, within a kernel, the cache line of array[row, col], an element that will be read soon."""
