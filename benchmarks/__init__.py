"""How fast rodnet is: its cases beside those of other codes, and where its time goes.

``make bench`` runs everything; ``python -m benchmarks --help`` lists the choices. One file per subject:

- `run`: the command; `process`: what all measurements share; `timing`: how times are taken and compared;
- `yardstick`: what this machine can do at best; `scenes`: what is simulated; `modes`: ways of stepping;
- `cases`: one module per table; `rivals`: one adapter per other code;
- `report`, `figures`: tables, JSON, Markdown and figures made from the results.
"""
