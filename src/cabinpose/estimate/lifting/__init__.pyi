from .predict import LiftedPredictor as LiftedPredictor
from .predict import OnnxLifting as OnnxLifting
from .predict import lifted as lifted
