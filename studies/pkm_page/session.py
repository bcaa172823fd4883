"""One session at a machine: its readings file, the advice after it, and every change.

All pages of a server share one session. Its adviser is that of `oed next`, so that page
and command decide alike.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from oed.base import Array
from oed.dataset import ReadingsColumn
from oed.estimation import IdentificationError
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from pkm_page import approach, doubts, rows, typed
from pkm_page.readings_log import REMARK, FileContent, ReadingsLog, StaleError
from pkm_studies.base import InputError
from pkm_studies.sessions import Advice, Adviser, FittedReadings, SkippedPose

#: what a fit of readings raises that make no sense
FIT_ERRORS: Final = (
    InputError,
    AssemblyError,
    IdentificationError,
    ValueError,
    ArithmeticError,
)
REMEMBERED_FITS: Final = 4  #: fits that are remembered, by version of the file
#: keys of entries that are remembered, so that one sent twice is taken once
MAX_KEYS: Final = 1000


class DoubtfulError(Exception):
    """A reading that is asked about before it is taken: `sentences` say why."""

    def __init__(self, sentences: Sequence[str]) -> None:
        self.sentences = list(sentences)
        super().__init__(" ".join(sentences))


class ReadingEntry(msgspec.Struct, forbid_unknown_fields=True):
    """A reading as the page sends it."""

    version: str  #: of the file that it is based on
    key: str  #: of the entry: one that is sent again is taken once
    entries: list[str]  #: what was typed, a text a column
    remark: str = ""
    direction: str = ""  #: of approach: "+1", "-1", or "" where it is not noted
    confirmed: bool = False  #: whether doubts were shown before


@dataclasses.dataclass(frozen=True)
class Pose:
    """Where the next reading is to be taken."""

    series: Series  #: of this reading alone, as the controller is sent it
    repeated: bool  #: whether it is the last reading's pose again


@dataclasses.dataclass(frozen=True)
class SessionState:
    """What all pages show."""

    content: FileContent  #: the readings file
    fitted: FittedReadings | None  #: its readings; None before the first one
    #: after them; None where they cannot be used: `problem` says why
    advice: Advice | None
    pose: Pose | None  #: of the next reading; None likewise
    problem: str = ""
    #: larger than that of any state before it, after a new start of the server too
    number: int = dataclasses.field(default_factory=time.time_ns)


class MachineSession:
    """A study's adviser with a readings file. Its methods may be called by any thread.

    changed  called with the version of each new state
    """

    def __init__(
        self,
        adviser: Adviser,
        path: Path,
        changed: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.adviser = adviser
        self.log = ReadingsLog(path)
        self.changed = changed
        self._lock = threading.RLock()
        self._fits: dict[str, FittedReadings | None] = {}
        self._keys: dict[str, None] = {}
        study, machine = adviser.base.study, self.measurement.machine
        self.effects_of_direction = approach.effects_of_direction(study, machine)
        self.state = self._state(self.log.read())

    @property
    def measurement(self) -> Measurement:
        """The machine with all set-ups of the study."""
        return self.adviser.everything

    # -- what changes ------------------------------------------------------------------
    def take(self, entry: ReadingEntry) -> None:
        """Take a reading at the present pose; on return it is on the disk.

        Raises StaleError, DoubtfulError, and InputError for what is no reading.
        """
        with self._lock:
            if entry.key in self._keys:
                return
            pose, content = self._pose(), self._based_on(entry.version)
            measurement, entries = self.measurement, entry.entries
            columns = rows.entry_columns(measurement, pose.series.setup)
            if len(entries) != len(columns):
                raise InputError("not as many numbers as columns", "type all of them")
            names = [ReadingsColumn.of(c.name, c.unit).name for c in columns]
            values = [typed.read(e, n) for e, n in zip(entries, names, strict=True)]
            sign = approach.cell(entry.direction, self.next_approach(content, pose))
            content = rows.add_clock(content, measurement)
            new = rows.reading_rows(measurement, pose.series, values, content)
            new[-1] |= rows.time_cell(content)
            if sign:
                new[-1][approach.DIRECTION] = sign
            if entry.remark:
                new[-1][REMARK] = rows.clean_remark(entry.remark)
            after = content.replace_rows(new)
            sentences = [] if entry.confirmed else self._doubts(after, values, entries)
            if sentences:
                raise DoubtfulError(sentences)
            written = self.log.write(entry.version, after)
            self._keys[entry.key] = None
            if len(self._keys) > MAX_KEYS:
                self._keys.pop(next(iter(self._keys)))
            self._publish(self._state(written))

    def undo(self, version: str) -> None:
        """Take the last reading back. Raises StaleError, InputError without a reading."""
        with self._lock:
            content = self._based_on(version)
            row = self._last(content)
            self._write(version, rows.mark_undone(content, row, self.measurement))

    def remark(self, version: str, text: str) -> None:
        """Write a remark beside the last reading. Raises as `undo`."""
        with self._lock:
            content = self._based_on(version)
            row = self._last(content)
            self._write(
                version, content.replace_cells(row, {REMARK: rows.clean_remark(text)})
            )

    def repeat(self, version: str, *, again: bool) -> None:
        """Read the last reading's pose again, or go on with the advice."""
        with self._lock:
            content = self._based_on(version)
            if again:
                self._last(content)
            self._publish(self._state(content, repeated=again))

    def skip(self, version: str, reason: str) -> None:
        """Skip the present pose: it is not advised again. Raises as `take`."""
        with self._lock:
            content, pose = self._based_on(version), self._pose()
            if pose.repeated:
                raise InputError("this pose was read already", "go on without")
            new = rows.skipped_rows(self.measurement, pose.series, content, reason)
            self._write(version, content.replace_rows(new))

    def take_skip_back(self, version: str) -> None:
        """Advise the pose that was skipped last again. Raises InputError without one."""
        with self._lock:
            content = self._based_on(version)
            skipped = rows.skipped(content, self.measurement)
            if not skipped:
                raise InputError("no pose is skipped", "load the page again")
            self._write(version, rows.remove_skip(content, skipped[-1]))

    def refresh(self) -> None:
        """Take up what others wrote into the file."""
        with self._lock:
            content = self.log.read()
            if content.version != self.state.content.version:
                self._publish(self._state(content))

    def next_approach(
        self, content: FileContent, pose: Pose
    ) -> approach.Approach | None:
        """The side from which a pose is to be approached; None where none matters."""
        measurement = self.measurement
        setup = measurement.setups[pose.series.setup]
        return approach.next_approach(
            content, measurement, setup, self.effects_of_direction
        )

    # -- what follows ------------------------------------------------------------------
    def _based_on(self, version: str) -> FileContent:
        self.refresh()
        if self.state.content.version != version:
            raise StaleError
        return self.state.content

    def _pose(self) -> Pose:
        if self.state.pose is None:
            raise InputError(
                self.state.problem or "there is no next reading", "mend the file"
            )
        return self.state.pose

    def _last(self, content: FileContent) -> int:
        row = rows.last_reading(content, self.measurement)
        if row is None:
            raise InputError("there is no reading yet", "take one first")
        return row

    def _write(self, version: str, content: FileContent) -> None:
        self._publish(self._state(self.log.write(version, content)))

    def _publish(self, state: SessionState) -> None:
        later = max(state.number, self.state.number + 1)
        self.state = dataclasses.replace(state, number=later)
        self.changed(state.content.version)

    def _state(self, content: FileContent, *, repeated: bool = False) -> SessionState:
        try:
            fitted = self._fit(content)
            cells = map(content.cells, range(1, len(content.rows)))
            skipped = list(SkippedPose.from_rows(cells, self.measurement))
            advice = self.adviser.advise_fitted(fitted, skipped)
            series, row = advice.series, advice.row
            is_repeated = repeated and fitted is not None
            if is_repeated and fitted is not None:
                series, row = self._last_pose(fitted)
            sent = rows.sent_cells(self.measurement, series, row)
        except FIT_ERRORS as error:
            return SessionState(content, None, None, None, str(error))
        return SessionState(content, fitted, advice, Pose(sent, is_repeated))

    def _last_pose(self, fitted: FittedReadings) -> tuple[Series, int]:
        data = fitted.state.resolved.dataset
        if data is None:
            raise LookupError("readings without a dataset")
        index = int(np.argmax(data.covariates["row"].to_numpy()))
        for series in data.series:
            if index < len(series):
                return series, index
            index -= len(series)
        raise IndexError(index)

    def _fit(self, content: FileContent) -> FittedReadings | None:
        if content.version not in self._fits:
            self._fits[content.version] = self._fit_of_text(content)
            if len(self._fits) > REMEMBERED_FITS:
                self._fits.pop(next(iter(self._fits)))
        return self._fits[content.version]

    def _fit_of_text(self, content: FileContent) -> FittedReadings | None:
        if len(content.rows) < 2:
            return None
        with tempfile.TemporaryDirectory(prefix="oed-") as folder:
            path = Path(folder) / self.log.path.name
            path.write_text(content.text, encoding="utf-8", newline="")
            try:
                return self.adviser.fit(path)
            except InputError as error:
                raise InputError(
                    error.problem,
                    error.remedy,
                    file=error.file.replace(folder + os.sep, ""),
                    field=error.field,
                    value=error.value,
                ) from error

    def _doubts(
        self, after: FileContent, values: Sequence[float], entries: Sequence[str]
    ) -> list[str]:
        """What speaks against the content's last reading."""
        pose = self._pose()
        fitted = self.state.fitted
        series, y = self._read_values(pose, values)
        expected = doubts.interval(self.adviser, fitted, series)
        sentences = doubts.value_doubts(
            self.measurement, series.setup, expected, y, entries
        )
        if sentences:
            return sentences
        try:
            refitted = self._fit_of_text(after)
        except FIT_ERRORS as error:
            return [f"With this reading: {error}"]
        if refitted is None:
            return []
        return list(doubts.session_doubts(fitted, refitted, self._row_in_file(after)))

    def _read_values(self, pose: Pose, values: Sequence[float]) -> tuple[Series, Array]:
        """The pose and the channels' values (k,), SI; joints where these are recorded."""
        measurement = self.measurement
        setup = measurement.setups[pose.series.setup]
        columns = rows.entry_columns(measurement, setup.name)
        si = np.array(
            [
                value * ReadingsColumn.of(c.name, c.unit).factor
                for c, value in zip(columns, values, strict=True)
            ]
        )
        if setup.instrument.implied is None:
            return pose.series, si
        try:
            series = measurement.series_from_joints(setup.name, si[None], ["entry"])
        except AssemblyError as error:
            raise InputError(
                f"the machine has no pose with these joints: {error}", "read them again"
            ) from error
        return series, np.full(len(setup.instrument.channels), setup.instrument.implied)

    def _row_in_file(self, content: FileContent) -> int:
        """Number of the last row as a spreadsheet counts, comments included."""
        return len(content.rows) + content.above.count("\n")
