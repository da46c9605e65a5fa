"""Excitation protocols, for backends; see :mod:`s2r_spec.backend.protocols`."""

from s2r_spec.backend.protocols import PLAYED as PLAYED
from s2r_spec.backend.protocols import PROTOCOL as PROTOCOL
from s2r_spec.backend.protocols import AttendsProtocols as AttendsProtocols
from s2r_spec.backend.protocols import HasInputs as HasInputs
from s2r_spec.backend.protocols import HasPlayable as HasPlayable
from s2r_spec.backend.protocols import HasProtocols as HasProtocols
from s2r_spec.backend.protocols import Place as Place
from s2r_spec.backend.protocols import Protocol as Protocol
from s2r_spec.backend.protocols import instructions as instructions
from s2r_spec.backend.protocols import named as named
from s2r_spec.backend.protocols import protocol_of as protocol_of
from s2r_spec.backend.protocols import run_protocol as run_protocol
from s2r_spec.backend.protocols import write_playable as write_playable
