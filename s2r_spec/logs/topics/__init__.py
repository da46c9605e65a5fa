"""Logs of several topics, each with its own time stamps: ROS bags, MCAP, ULog, HDF5, MATLAB.

A format module only parses: it lists the topics of a file and reads the chosen fields. :mod:`s2r_spec.logs.topics.join`
brings them to the stamps of one topic, which gives the table that :mod:`s2r_spec.logs.interpret` makes a trace of.
"""
