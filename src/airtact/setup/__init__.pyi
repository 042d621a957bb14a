from .building import Setup as Setup
