# SPDX-License-Identifier: Apache-2.0
"""Shorter pipelines of numba for the functions of a loop; the numbers are the same (ours).

A loop is some thirty plain scalar functions that end up inlined into one. numba would run passes
for closures, arrays and parallel loops over each of them, optimise each to the end and emit
machine code for each, all of which the one function that is called does again. Here a function
that only compiled ones call is left as LLVM code for its caller. It takes two thirds of the time.

This is inside numba: only versions in `TESTED` are compiled so, others as numba compiles anything.
"""

from __future__ import annotations

from functools import cache
from typing import Any

TESTED = ((0, 68),)
"""Versions of numba, major and minor, whose pipeline this was tested with."""


@cache
def compilers() -> tuple[type, type] | None:
    """Return the compilers of functions that Python calls, and that only compiled ones call.

    None where this version of numba was not tested.
    """
    from numba import version_info

    if tuple(version_info.short) not in TESTED:
        return None
    from numba import _dynfunc
    from numba.core import typed_passes, untyped_passes
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import _LowerResult, CompilerBase
    from numba.core.compiler_machinery import PassManager, register_pass
    from numba.core.errors import UnsupportedError

    class InlinedLibrary(JITCodeLibrary):  # type: ignore[misc]
        """Code of a function that is only ever linked into its callers'."""

        def _optimize_final_module(self) -> None:
            """Leave that to the caller's code."""

        def _finalize_final_module(self) -> None:
            """Emit no machine code."""
            self._finalize_dynamic_globals()
            self._finalized = True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class InlinedLowering(typed_passes.NativeLowering):  # type: ignore[misc]
        """Lowering to LLVM code without machine code."""

        _name = 'dz_ros_inlined_lowering'

        def run_pass(self, state: Any) -> bool:
            """Lower the function and register it for its callers."""
            state.library = InlinedLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
            state.flags.no_compile = True
            super().run_pass(state)
            found = state['cr']
            if found.env.consts:        # objects that only a function of its own could reach
                raise UnsupportedError(f'{found.fndesc.qualname} reads Python objects')
            description = found.fndesc
            function = _dynfunc.make_function(
                description.lookup_module(), description.qualname.split('.')[-1], '', 0, found.env,
                (state.library,))
            state.targetctx.insert_user_function(function, description, [state.library])
            state['cr'] = _LowerResult(description, found.call_helper, cfunc=function,
                                       env=found.env)
            return True

    def pipeline(lowering: type) -> list[Any]:
        """Return the passes that plain scalar code needs."""
        manager = PassManager('scalar')
        for item in (untyped_passes.TranslateByteCode, untyped_passes.FixupArgs,
                     untyped_passes.IRProcessing, untyped_passes.RewriteSemanticConstants,
                     untyped_passes.DeadBranchPrune, untyped_passes.GenericRewrites,
                     untyped_passes.RewriteDynamicRaises, untyped_passes.ReconstructSSA,
                     typed_passes.NopythonTypeInference, typed_passes.PreLowerStripPhis,
                     typed_passes.IRLegalization, lowering, typed_passes.NoPythonBackend):
            manager.add_pass(item, item.__name__)
        manager.finalize()
        return [manager]

    class Inlined(CompilerBase):  # type: ignore[misc]
        """Compiler of a function that only compiled functions call."""

        def define_pipelines(self) -> list[Any]:
            """Return its one pipeline."""
            return pipeline(InlinedLowering)

    class Called(CompilerBase):  # type: ignore[misc]
        """Compiler of a function that Python calls."""

        def define_pipelines(self) -> list[Any]:
            """Return its one pipeline."""
            return pipeline(typed_passes.NativeLowering)

    return Called, Inlined
