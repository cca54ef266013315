"""The measurements of the papers that Cardan follows, repeated: one report (``cardan evaluate``).

Each study is a folder that measures and returns tables of published and measured values, figures
for comparison with other reports, and pictures.
"""
