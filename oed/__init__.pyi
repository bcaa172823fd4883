from oed.effect import Column as Column
from oed.effect import Effect as Effect
from oed.instrument import Channel as Channel
from oed.instrument import Instrument as Instrument
from oed.instrument import Setting as Setting
from oed.instrument import mount as mount
from oed.machine import Component as Component
from oed.machine import Coordinate as Coordinate
from oed.machine import Machine as Machine
from oed.machine import Parameter as Parameter
from oed.measurement import Measurement as Measurement
from oed.result import StudyResult as StudyResult
from pkm_studies.errors import InputError as InputError
from pkm_studies.notebook import build_study as build_study
from pkm_studies.notebook import choose_design as choose_design
from pkm_studies.notebook import diagnose as diagnose
from pkm_studies.notebook import identify as identify
from pkm_studies.notebook import load_study as load_study
from pkm_studies.notebook import plan as plan
from pkm_studies.notebook import predict as predict
from pkm_studies.notebook import read_readings as read_readings
from pkm_studies.notebook import run as run
from pkm_studies.notebook import sample as sample
from pkm_studies.notebook import simulate as simulate
from pkm_studies.notebook import write_report as write_report
from pkm_studies.study import Study as Study

__version__: str
