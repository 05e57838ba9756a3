"""numba's compiler without the work that the hot path does not need. It takes a third off a first start.

* numba makes machine code of every function that another one calls, even of one that is inlined there, and links and
  optimizes all its callees anew: what stands twelve calls deep is optimized twelve times. A `Piece` stays an
  intermediate form until a `Whole`, which Python or a pointer calls, links and optimizes it once. 5 of 17 s of
  processor time went into that.
* The hot path has no closures, `with` blocks or unrolled literals. The passes that look for them are left out. That
  saves 8 % of the time.
* Loops stay compact and take one number at a time: they run over a few channels, and the compiler would turn each into
  a dozen, for every number of channels. Vectors cost more than they save there, 6 % of an exchange in memory.
  `BulkWhole` and `BulkPiece` are for loops over many numbers, which gain by both.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import _dynfunc, types
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.errors import TypingError
from numba.core.imputils import lower_constant
from numba.core.lowering import Lower
from numba.core.typing.templates import infer_global
from numba.extending import models, register_model

KNOWN = (0, 68)
"""Newest version of numba with which `tools/numba_versions` has tried this."""


class _LinkedLater(JITCodeLibrary):
    """The code of a piece, with that of its own pieces. It is neither optimized nor translated."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


class _NotVectorized(JITCodeLibrary):
    """Machine code whose loops take one number at a time."""

    def _optimize_final_module(self) -> None:
        for options in ({"cost": "cheap", "slp_vectorize": False}, {}):
            passes, builder = self._codegen._module_pass_manager(loop_vectorize=False, **options)
            passes.run(self._final_module, builder)


class _LowerCompact(Lower):
    def setup_function(self, fndesc: Any) -> None:
        super().setup_function(fndesc)
        self.function.attributes.add("optsize")


@register_pass(mutates_CFG=True, analysis_only=False)
class _WholePass(typed_passes.NativeLowering):
    _name = "lower_whole"
    lowering_class = _LowerCompact

    def run_pass(self, state: Any) -> bool:
        """Lowers the function into a library whose loops are not vectorized."""
        state.library = _NotVectorized(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _BulkPiecePass(typed_passes.NativeLowering):
    _name = "lower_bulk_piece"

    def run_pass(self, state: Any) -> bool:
        """Lowers the piece into a library of its own, and makes it known to numba under an object."""
        state.flags.no_compile = True
        state.library = _LinkedLater(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        super().run_pass(state)
        lowered = state["cr"]
        where, name = lowered.fndesc.lookup_module(), lowered.fndesc.qualname
        # numba knows a compiled function by an object. This one's code address is 0: nobody calls it from Python.
        known_by = _dynfunc.make_function(where, name, "", 0, lowered.env, (state.library,))
        state.targetctx.insert_user_function(known_by, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=known_by)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PiecePass(_BulkPiecePass):
    _name = "lower_piece"
    lowering_class = _LowerCompact


class BulkWhole(CompilerBase):
    """Compiles a function that is called from outside, with loops over many numbers."""

    lowering: Any = typed_passes.NativeLowering

    def define_pipelines(self) -> list[PassManager]:
        """Returns numba's passes that the hot path needs, with the class's own lowering."""
        manager = PassManager("hot path")
        for one in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            untyped_passes.IRProcessing,
            untyped_passes.ReconstructSSA,
            typed_passes.NopythonTypeInference,
            typed_passes.PreLowerStripPhis,
            typed_passes.NoPythonSupportedFeatureValidation,
            typed_passes.IRLegalization,
            self.lowering,
            typed_passes.NoPythonBackend,
        ):
            manager.add_pass(one, one.__name__)
        manager.finalize()
        return [manager]


class Whole(BulkWhole):
    """Compiles a function that is called from outside. Its loops stay compact."""

    lowering = _WholePass


class BulkPiece(BulkWhole):
    """Compiles a function that only compiled functions call, with loops over many numbers."""

    lowering = _BulkPiecePass


class Piece(BulkWhole):
    """Compiles a function that only compiled functions call. Its loops stay compact."""

    lowering = _PiecePass


class PieceType(types.Dispatcher):
    """numba's type of a piece, which is compiled once for each choice of types, for all callers and constants.

    Called from Python, the function stays plain Python: numba looks its type up when compiled code names it.
    """

    def __init__(self, function: Any, dispatcher: Any) -> None:
        self._keeps = dispatcher  # numba refers to it weakly
        super().__init__(dispatcher)
        infer_global(function, self)

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Returns the signature of a call. Constants are of any value, unless the piece needs to know the value."""
        of_any_value = tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()}
        try:
            return super().get_call_type(context, *of_any_value)
        except TypingError:
            if of_any_value == (tuple(args), kws):
                raise
            return super().get_call_type(context, args, kws)


register_model(PieceType)(models.OpaqueModel)


@lower_constant(PieceType)
def _name_piece(context: Any, _builder: Any, _kind: Any, _function: Any) -> Any:
    """Returns a value that nothing uses. numba's own for a dispatcher is an address, with which no code is kept."""
    return context.get_dummy_value()


def try_out() -> None:
    """Compiles and calls a small function of each kind where numba is newer than `KNOWN`. Raises what numba raises."""
    if numba.version_info.short <= KNOWN:
        return
    for piece, whole in ((Piece, Whole), (BulkPiece, BulkWhole)):

        def _doubled(number: float) -> float:
            return 2.0 * number

        def _sum(numbers: Any) -> float:
            total = 0.0
            for one in numbers:
                total += _doubled(one)
            return total

        PieceType(_doubled, numba.njit(no_cpython_wrapper=True, pipeline_class=piece)(_doubled))
        found = numba.njit(pipeline_class=whole)(_sum)(np.arange(9.0))
        if found != 72.0:
            raise ValueError(f"a sum of 72 is compiled to {found}")
