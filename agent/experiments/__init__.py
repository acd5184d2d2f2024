"""The paper's experiments, and more, on the twin: each has Settings, run and table, some have figures."""
