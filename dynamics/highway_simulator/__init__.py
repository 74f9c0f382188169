"""highway-env's straight highway, compiled: the same to the last bit, and a thousand times as fast.

`simulator` has the arrays and steps them, `env` one environment, `vector_env` many behind Gymnasium's interface;
`scenario` and `refusals` say what of highway-env's configuration can be run. The rest are kernels, one concept a file.
"""
