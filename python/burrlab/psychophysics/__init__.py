"""Can it be felt? Experiments on what people tell apart: designed, run, simulated, analysed."""
