"""The paper's experiments, and more, on the twin: a folder each, all of one shape.

    run.py      Settings, what can be asked for; run(settings, progress) -> Result, which is result.json's content
    tables.py   table(result), for the terminal
    figures.py  figures(result), where there is something to draw

Beside the folders lies what they share: perform.py takes any of them from the command line to its folder.
"""
