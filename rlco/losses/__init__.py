"""What is minimised, and how; TorchRL's own losses wherever it has them."""

from rlco.losses.co_training import CoTrainingLoss as CoTrainingLoss
from rlco.losses.gradient_agreement import gradient_agreement as gradient_agreement
from rlco.losses.gradient_signal import gradient_signal as gradient_signal
from rlco.losses.imitation import ImitationLoss as ImitationLoss
from rlco.losses.log_probs import log_probs as log_probs
