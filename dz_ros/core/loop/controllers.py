# SPDX-License-Identifier: Apache-2.0
"""Controllers of all axes of a loop, answered together, with the interface of one (ours).

Each axis is the scalar `Controller`; what is asked of one is asked of all. A step that one axis
must not take is taken by none. A law that knows all axes (`Law.coupled`) is given the references,
states and memories of the others from before the step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from dz_ros.core.axes import all_finite, Rows
from dz_ros.core.configuration import Configuration
from dz_ros.core.laws.base import Law
from dz_ros.core.loop.controller import Controller, ViolationError
from dz_ros.core.loop.coupled import own_first

Memory = tuple[tuple[float, ...], ...]


class Laws:
    """Laws of the axes as their guard asks for them: memories in, memories out, a row an axis."""

    def __init__(self, laws: Sequence[Law]) -> None:
        self._laws = laws

    def initial_memory(self) -> Memory:
        """Memory before the first sample."""
        return tuple(law.initial_memory() for law in self._laws)

    def take_over(self, memory: Memory) -> Memory:
        """Return the memory for a new start from whatever state the plant is in."""
        return tuple(law.take_over(row) for law, row in zip(self._laws, memory, strict=True))

    def reset_guard(self, memory: Memory) -> Memory:
        """Return the memory with latched guards released."""
        return tuple(law.reset_guard(row) for law, row in zip(self._laws, memory, strict=True))


class Limiters:
    """Command limiters of the axes as they are reported."""

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self._controllers = controllers

    @property
    def limited(self) -> int:
        """Number of commands changed by the rate, the ramp or the limit, of all axes."""
        return sum(item.limiter.limited for item in self._controllers)


class Controllers:
    """Answers the states of all axes with commands; what it takes and gives are `Rows`.

    Args:
        configuration: Of a machine of several axes.

    Attributes:
        names: The axes.
        each: Their controllers.
        law: Their laws.
        limiter: Their command limiters.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.names = configuration.axis_names
        self.each = [Controller(item) for item in configuration.each]
        self.limiter = Limiters(self.each)
        self.configure(configuration)

    def __iter__(self) -> Iterator[Controller]:
        return iter(self.each)

    def configure(self, configuration: Configuration) -> None:
        """Take other gains and limits from the next step on; the structure must be the same."""
        for controller, item in zip(self.each, configuration.each, strict=True):
            controller.configure(item)
        self.law = Laws([item.law for item in self.each])
        self._coupled = self.each[0].law.coupled

    @property
    def memory(self) -> Memory:
        """Memories of the laws before the next step."""
        return tuple(item.memory for item in self.each)

    @memory.setter
    def memory(self, memory: Memory) -> None:
        for item, row in zip(self.each, memory, strict=True):
            item.memory = row

    def follow(self, psi: float | None) -> None:
        """Take the scheduling variable as measured, for every axis."""
        for controller in self.each:
            controller.follow(psi)

    @property
    def ignored(self) -> dict[str, int]:
        """Reason → number of states that were not answered by a step."""
        return self.each[0].ignored

    @property
    def error(self) -> float:
        """Largest |x̃| of the last step, unit of x."""
        return max(abs(item.error) for item in self.each)

    @property
    def count(self) -> int:
        """Number of commands given so far, the seq of the next one."""
        return self.each[0].count

    @property
    def has_reference(self) -> bool:
        """Whether any reference has arrived."""
        return self.each[0].has_reference

    def has_reference_for(self, state: Rows) -> bool:
        """Whether the references meant for this very state have arrived."""
        return self.each[0].has_reference_for(state[0])

    def newest_reference(self) -> float:
        """Return the stamp of the newest references [s]; −∞ before the first."""
        return self.each[0].newest_reference()

    def restart(self, memory: Memory) -> None:
        """Let the laws take over in the next step, with these memories."""
        for item, row in zip(self.each, memory, strict=True):
            item.restart(row)

    def set_reference(self, reference: Rows) -> None:
        """Take the references of all axes; where one is not finite none is taken."""
        if all_finite([row.x_d for row in reference]):
            for item, row in zip(self.each, reference, strict=True):
                item.set_reference(row)
        else:
            self.each[0].ignored['not_finite'] += 1

    def respond(self, state: Rows) -> tuple[Rows, Rows] | None:
        """Return commands and terms for the states; None where they must not be answered.

        Raises:
            LookupError: No reference has arrived yet.
            ViolationError: An axis must not take the step, which is named; none has taken it.
        """
        if not all_finite([row.x for row in state]):
            self.each[0].ignored['not_finite'] += 1
            return None
        if self._coupled and self.has_reference:
            self._let_know(state)
        marks = [item.mark() for item in self.each]
        answers: list[Any] = []
        for name, item, row in zip(self.names, self.each, state, strict=True):
            try:
                answers.append(item.respond(row))
            except ViolationError as error:
                for done, mark in zip(self.each[:len(answers)], marks, strict=False):
                    done.rewind(mark)
                raise ViolationError(f'axis {name}: {error}', error.step) from error
        if None in answers:         # one seq: then none was answered
            return None
        return Rows(command for command, _ in answers), Rows(terms for _, terms in answers)

    def safe_answer(self, state: Rows) -> tuple[Rows, Rows]:
        """Return the safe commands and their terms, without a step of the laws."""
        answers = [item.safe_answer(row) for item, row in zip(self.each, state, strict=True)]
        return Rows(command for command, _ in answers), Rows(terms for _, terms in answers)

    def _let_know(self, state: Rows) -> None:
        """Give each controller the references, states and memories of the others."""
        rows = ([item.reference_at(row).x_d for item, row in zip(self.each, state, strict=True)],
                [row.x for row in state], [item.memory for item in self.each])
        for place, item in enumerate(self.each):
            item.others = tuple(own_first(found, place)[len(found[place]):] for found in rows)


def controller_of(configuration: Configuration) -> Any:
    """Return the controller of a loop: a `Controller`, of several axes `Controllers`."""
    return Controllers(configuration) if len(configuration.axes) > 1 else Controller(configuration)
