"""Readings of virtual machines in a plan's stages; those out of travel are lost."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.design.stages.stage.prediction import PlanStage
from oed.measurement import Measurement, Series
from oed.model.instrument import Setup


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualReadings:
    """Readings (N) of m machines.

    series      with the joints that each machine is sent
    y           (m, N) SI; NaN where a pose cannot be assembled
    captured    (m, N) which readings are captured
    lost_share  (m,) share of the chosen candidates that is lost
    """

    series: tuple[Series, ...]
    y: Array
    captured: Mask
    lost_share: Array


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualStage:
    """One stage as it is carried out.

    measurement    all set-ups up to this stage, so that its parameters begin with those
                   of the stage before
    series         planned readings
    candidate      (readings,) candidate that each number belongs to
    first_channel  (readings,) which numbers are first channels: the travel limits them
    travel         m or rad; infinite: unlimited
    """

    measurement: Measurement
    series: tuple[Series, ...]
    candidate: Index
    first_channel: Mask
    travel: float

    def read(
        self,
        truth: Array,
        expected: Array,
        controller: Array | None,
        normals: Array,
    ) -> VirtualReadings:
        """Readings of machines with parameters `truth` (m, n).

        expected    (m, n) parameters for which readings are expected
        controller  (m, np) parameters that the controllers use; None: nominal ones
        normals     (m, readings) standard normal numbers that become the noise
        """
        measurement = self.measurement
        sent = tuple(self._send(s, controller) for s in self.series)
        exact = measurement.try_readings(sent, truth)
        # a pose that cannot be assembled cannot be read
        lost = np.isnan(exact)
        if math.isfinite(self.travel):
            deviation = np.abs(exact - measurement.try_readings(sent, expected))
            lost |= self.first_channel & ~(deviation <= self.travel)
        candidates = int(self.candidate[-1]) + 1
        belongs = self.candidate[:, None] == np.arange(candidates)
        complete = (lost @ belongs.astype(float)) == 0.0
        noise = [
            measurement.noise([s.of_machines(k) for s in sent]).correlate(normal)
            for k, normal in enumerate(normals)
        ]
        return VirtualReadings(
            series=sent,
            y=exact + np.array(noise),
            captured=complete[:, self.candidate],
            lost_share=1.0 - complete.mean(axis=1),
        )

    def _send(self, series: Series, controller: Array | None) -> Series:
        """The series with the joints that each machine's controller sends.

        Recorded joints stay as they are.
        """
        if controller is None or np.isnan(series.command).any():
            return series
        tool = np.array(self.measurement.setups[series.setup].tool)
        (machines, _), (poses, _) = controller.shape, series.command.shape
        command = np.tile(series.command, (machines, 1))
        parameters = np.repeat(controller, poses, axis=0)
        x, q = self.measurement.kinematics.inverse(command, parameters, tool)
        return dataclasses.replace(
            series,
            q=q.reshape(machines, poses, -1),
            start=x.reshape(machines, poses, -1),
        )


def prepare_stages(stages: Sequence[PlanStage]) -> tuple[VirtualStage, ...]:
    """The stages of a plan, ready to be carried out one after the other."""
    setups: list[Setup] = []
    virtual = []
    for number, stage in enumerate(stages, start=1):
        measurement = stage.option.measurement
        # A set-up mounted in two stages stands elsewhere in each: it gets a name and
        # parameters of its own.
        for setup in measurement.setups.values():
            name = _stage_name(number, setup.name)
            setups.append(dataclasses.replace(setup, name=name))
        series = tuple(
            dataclasses.replace(s, setup=_stage_name(number, s.setup))
            for s in stage.series
        )
        channels = _channels(stage)
        counts = stage.option.candidates.members[stage.chosen, 1]
        candidate_of_reading = np.repeat(np.arange(len(stage.chosen)), counts)
        first_channel = np.zeros(channels.sum(), dtype=bool)
        first_channel[np.cumsum(channels) - channels] = True
        virtual.append(
            VirtualStage(
                measurement=measurement.with_setups(setups),
                series=series,
                candidate=np.repeat(candidate_of_reading, channels),
                first_channel=first_channel,
                travel=stage.option.travel,
            )
        )
    return tuple(virtual)


def _channels(stage: PlanStage) -> Index:
    """Number of channels of each planned reading."""
    setups = stage.option.measurement.setups
    counts = [np.full(len(s), len(setups[s.setup].sigma)) for s in stage.series]
    return np.concatenate(counts)


def _stage_name(number: int, setup: str) -> str:
    return f"{number}. {setup}"
