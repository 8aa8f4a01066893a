"""Eight numbers that are computed as one: a numba type for the lanes of a SIMD register.

The kernels of `newton/` and of `quality/support.py` are written once, for values of an unnamed
number type, and compiled twice: for `float64`, one problem at a time, and for `Lanes`, eight
problems side by side. The functions here are what both types share beyond arithmetic and
comparison. A comparison of lanes gives a mask of eight bits; `&`, `|` and `~` combine masks as they
do booleans.

Numbers of a kernel live in one flat workspace of *slots*: a slot is one float64, or eight that lie
side by side.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core.datamodel import PrimitiveModel
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, overload, register_model

WIDTH = 8
"""Numbers in `Lanes`: one AVX-512 register, two of AVX2."""

_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)
KERNEL: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
"""Options of every function that may be compiled for lanes: products may be fused with sums, and a
division by zero is no exception, for which each division would need a branch."""

# a product may be fused with a sum, as both compilations do; nothing else may be reordered
_FLAGS = ("contract",)


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Lanes")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="LaneMask")


lanes_type = _LanesType()
mask_type = _MaskType()


@register_model(_LanesType)
class _LanesModel(PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


@register_model(_MaskType)
class _MaskModel(PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _BITS)


def _spread(builder: Any, value: Any) -> Any:
    """One number in every lane."""
    first = builder.insert_element(
        ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(_VECTOR, ir.Undefined), zeros)


def _vectors(context: Any, builder: Any, sig: Any, args: Any) -> list[Any]:
    """The arguments as vectors; numbers are spread."""
    vectors = []
    for value, kind in zip(args, sig.args, strict=True):
        if kind is lanes_type:
            vectors.append(value)
        else:
            vectors.append(_spread(builder, context.cast(builder, value, kind, types.float64)))
    return vectors


def _binary(function: Any, result: Any, build: Callable[[Any, Any, Any], Any]) -> None:
    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            known = all(a is lanes_type or isinstance(a, types.Number) for a in args)
            if known and len(args) == 2 and lanes_type in args:
                return signature(result, *args)
            return None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return build(builder, *_vectors(context, builder, sig, args))

    for pair in (
        (lanes_type, lanes_type),
        (lanes_type, types.Number),
        (types.Number, lanes_type),
    ):
        lower_builtin(function, *pair)(lower)


for _function, _name in (
    (operator.add, "fadd"),
    (operator.iadd, "fadd"),
    (operator.sub, "fsub"),
    (operator.isub, "fsub"),
    (operator.mul, "fmul"),
    (operator.imul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _binary(
        _function,
        lanes_type,
        lambda builder, a, b, name=_name: getattr(builder, name)(a, b, flags=_FLAGS),
    )
for _function, _name in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    _binary(
        _function,
        mask_type,
        lambda builder, a, b, name=_name: builder.fcmp_ordered(name, a, b),
    )


def _of_masks(function: Any, arguments: int, build: Callable[..., Any]) -> None:
    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if args == (mask_type,) * arguments:
                return signature(mask_type, *args)
            return None

    @lower_builtin(function, *(mask_type,) * arguments)
    def _lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return build(builder, *args)


for _function in (operator.and_, operator.iand):
    _of_masks(_function, 2, lambda builder, a, b: builder.and_(a, b))
for _function in (operator.or_, operator.ior):
    _of_masks(_function, 2, lambda builder, a, b: builder.or_(a, b))
_of_masks(operator.invert, 1, lambda builder, a: builder.not_(a))


@infer_global(operator.neg)
class _Negation(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(lanes_type, *args) if args == (lanes_type,) else None


@lower_builtin(operator.neg, lanes_type)
def _negate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


@intrinsic
def _select(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return lanes_type(mask_type, lanes_type, lanes_type), build


@intrinsic
def _as_lanes(typing_context: Any, value: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, args[0])

    return lanes_type(types.float64), build


@intrinsic
def _sqrt(typing_context: Any, value: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        name = f"llvm.sqrt.v{WIDTH}f64"
        function = builder.module.globals.get(name)
        if function is None:
            function = ir.Function(builder.module, ir.FunctionType(_VECTOR, [_VECTOR]), name)
        return builder.call(function, args)

    return lanes_type(lanes_type), build


@intrinsic
def _any(typing_context: Any, mask: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(mask_type), build


def _vector_pointer(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array = context.make_array(sig.args[0])(context, builder, args[0])
    slot = context.cast(builder, args[1], sig.args[1], types.intp)
    start = builder.mul(slot, ir.Constant(slot.type, WIDTH))
    return builder.bitcast(builder.gep(array.data, [start]), _VECTOR.as_pointer())


@intrinsic
def _load(typing_context: Any, workspace: Any, slot: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_vector_pointer(context, builder, sig, args), align=8)

    return lanes_type(workspace, slot), build


@intrinsic
def _store(typing_context: Any, workspace: Any, slot: Any, value: Any) -> Any:
    def build(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _vector_pointer(context, builder, sig, args), align=8)
        return context.get_dummy_value()

    return types.void(workspace, slot, lanes_type), build


def load(workspace: Any, slot: Any, like: Any) -> Any:
    """The number in a slot, of the type of `like`."""
    raise NotImplementedError("for compiled code")


def store(workspace: Any, slot: Any, value: Any) -> None:
    """Write a number to a slot."""
    raise NotImplementedError("for compiled code")


def where(mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask holds, else `b`."""
    raise NotImplementedError("for compiled code")


def root(value: Any) -> Any:
    """The square root."""
    raise NotImplementedError("for compiled code")


def holds(mask: Any) -> bool:
    """Whether the mask holds anywhere."""
    raise NotImplementedError("for compiled code")


@njit(**KERNEL)
def larger(a: Any, b: Any) -> Any:
    """The larger of two numbers."""
    return where(a > b, a, b)


@njit(**KERNEL)
def smaller(a: Any, b: Any) -> Any:
    """The smaller of two numbers."""
    return where(a < b, a, b)


@njit(**KERNEL)
def size(value: Any) -> Any:
    """The absolute value."""
    return where(value < 0.0, -value, value)


@overload(load, inline="always")
def _overload_load(workspace, slot, like):
    if like is lanes_type:
        return lambda workspace, slot, like: _load(workspace, slot)
    return lambda workspace, slot, like: workspace[slot]


@overload(store, inline="always")
def _overload_store(workspace, slot, value):
    if value is lanes_type:
        return lambda workspace, slot, value: _store(workspace, slot, value)

    def plain(workspace, slot, value):
        workspace[slot] = value

    return plain


@overload(where)
def _overload_where(mask, a, b):
    if mask is not mask_type:
        return lambda mask, a, b: a if mask else b
    if a is lanes_type and b is lanes_type:
        return lambda mask, a, b: _select(mask, a, b)
    if a is lanes_type:
        return lambda mask, a, b: _select(mask, a, _as_lanes(b))
    if b is lanes_type:
        return lambda mask, a, b: _select(mask, _as_lanes(a), b)
    return lambda mask, a, b: _select(mask, _as_lanes(a), _as_lanes(b))


@overload(root)
def _overload_root(value):
    if value is lanes_type:
        return lambda value: _sqrt(value)
    return lambda value: value**0.5


@overload(holds)
def _overload_holds(mask):
    if mask is mask_type:
        return lambda mask: _any(mask)
    return lambda mask: mask


@njit(**KERNEL)
def lanes(value: float) -> Any:
    """The number in all eight lanes."""
    return _as_lanes(value)
