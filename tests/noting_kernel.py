"""The native kernel, which notes what is done with it."""

from __future__ import annotations

from collections import Counter
from typing import Any

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.backends.cpu.optimiser import CpuOptimiser
from decogs.encoder.backends.cpu.view_gradients import CpuViewGradients
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats


class NotingKernel(CpuKernel):
    """``viewed``: fixed views made, by camera; ``rendered``: pictures without one; ``rates`` of steps taken.

    ``done``: names of what its views, gradients and optimisers do, and the camera, "" for none;
    ``times``: how often.
    """

    def __init__(self, threads: int = 1) -> None:
        super().__init__(threads)
        self.viewed: list[str] = []
        self.done: list[tuple[str, Any]] = []
        self.times, self.rendered = Counter[str](), Counter[str]()
        self.rates: list[LearningRates] = []

    def note(self, what: str, camera: str = "") -> None:
        self.done.append((what, camera))
        self.times[what] += 1

    def forward(self, splats: Splats, camera: Camera, **options: Any) -> Any:
        self.rendered[camera.name] += 1
        return super().forward(splats, camera, **options)

    def fixed_view(self, camera: Camera) -> CpuFixedView:
        self.viewed.append(camera.name)
        return _View(self, camera)

    def view_gradients(self, count: int) -> CpuViewGradients:
        return _ViewGradients(self, count)

    def optimiser(self, splats: Splats, **betas: float) -> CpuOptimiser:
        return _Optimiser(splats, self, **betas)


class _View(CpuFixedView):
    def __init__(self, kernel: NotingKernel, camera: Camera) -> None:
        super().__init__(kernel, camera)
        self._note = kernel.note

    def detach(self, *given: Any, **named: Any) -> Any:
        self._note("detach", self.camera.name)
        return super().detach(*given, **named)

    def draw(self, *given: Any, **named: Any) -> Any:
        self._note("draw", self.camera.name)
        return super().draw(*given, **named)

    def redraw(self, *given: Any, **named: Any) -> Any:
        self._note("redraw", self.camera.name)
        return super().redraw(*given, **named)

    def refresh(self, *given: Any, **named: Any) -> Any:
        self._note("refresh", self.camera.name)
        return super().refresh(*given, **named)

    def backward(self, *given: Any, **named: Any) -> Any:
        self._note("backward", self.camera.name)
        return super().backward(*given, **named)

    def commit(self, *given: Any, **named: Any) -> Any:
        self._note("commit", self.camera.name)
        return super().commit(*given, **named)


class _ViewGradients(CpuViewGradients):
    def __init__(self, kernel: NotingKernel, count: int) -> None:
        super().__init__(count)
        self._note = kernel.note

    def add(self, gradients: Any, camera: Camera, emphasis: float = 1.0) -> None:
        self._note("gather", camera.name)
        super().add(gradients, camera, emphasis)


class _Optimiser(CpuOptimiser):
    def __init__(self, splats: Splats, kernel: NotingKernel, **betas: float) -> None:
        super().__init__(splats, kernel, **betas)
        self._noted, self._note = kernel.rates, kernel.note

    def freeze(self, frozen: Any) -> None:
        self._note("freeze")
        super().freeze(frozen)

    def step(self, gradients: Any, rates: LearningRates, **options: Any) -> None:
        self._noted.append(rates)
        super().step(gradients, rates, **options)
