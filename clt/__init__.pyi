from clt.api import Localization as Localization
from clt.api import evaluate as evaluate
from clt.api import load as load
from clt.api import localize as localize
from clt.api import simulate as simulate
from clt.tables import data_frames as data_frames
from clt.tables import score_frame as score_frame

__version__: str
