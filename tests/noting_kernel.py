"""The native kernel, which notes what is done with it."""

from __future__ import annotations

from typing import Any

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.backends.cpu.optimiser import CpuOptimiser
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats


class NotingKernel(CpuKernel):
    """``viewed``: fixed views made, by camera; ``done``: names of what they do, and which; ``rates`` of steps taken."""

    def __init__(self) -> None:
        super().__init__(1)
        self.viewed: list[str] = []
        self.done: list[tuple[str, str]] = []
        self.rates: list[LearningRates] = []

    def fixed_view(self, camera: Camera, recorded: Any = None) -> CpuFixedView:
        self.viewed.append(camera.name)
        return _View(self, camera, recorded)

    def optimiser(self, splats: Splats, **betas: float) -> CpuOptimiser:
        return _Optimiser(splats, self, **betas)


class _View(CpuFixedView):
    def __init__(self, kernel: NotingKernel, camera: Camera, recorded: Any) -> None:
        super().__init__(kernel, camera, recorded)
        self._done = kernel.done

    def detach(self, *given: Any, **named: Any) -> Any:
        self._done.append(("detach", self.camera.name))
        return super().detach(*given, **named)

    def draw(self, *given: Any, **named: Any) -> Any:
        self._done.append(("draw", self.camera.name))
        return super().draw(*given, **named)

    def redraw(self, *given: Any, **named: Any) -> Any:
        self._done.append(("redraw", self.camera.name))
        return super().redraw(*given, **named)

    def refresh(self, *given: Any, **named: Any) -> Any:
        self._done.append(("refresh", self.camera.name))
        return super().refresh(*given, **named)

    def backward(self, *given: Any, **named: Any) -> Any:
        self._done.append(("backward", self.camera.name))
        return super().backward(*given, **named)

    def commit(self, *given: Any, **named: Any) -> Any:
        self._done.append(("commit", self.camera.name))
        return super().commit(*given, **named)


class _Optimiser(CpuOptimiser):
    def __init__(self, splats: Splats, kernel: NotingKernel, **betas: float) -> None:
        super().__init__(splats, kernel, **betas)
        self._noted = kernel.rates

    def step(self, gradients: Any, rates: LearningRates, **options: Any) -> None:
        self._noted.append(rates)
        super().step(gradients, rates, **options)
