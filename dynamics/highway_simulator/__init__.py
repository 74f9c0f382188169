"""highway-env's straight highway, compiled: the same to the last bit, and a thousand times as fast.

`simulator` has the arrays and steps them. `env` is one environment, `vector_env` many environments with Gymnasium's
interface. `scenario` and `supported_configs` define which of highway-env's configurations are supported. The other
files are kernels, one concept a file.
"""
