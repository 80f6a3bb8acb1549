"""Tables of any app: text, JSON, spreadsheets and MATLAB, with named or guessed columns.

`text_sheets`, `spreadsheet`, `matlab` and `json_tables` turn a file into a `Sheet`: names of columns, which of them are
times, and a function that parses the rows. Quantities, units, signs and clocks are guessed from `Sheet` alone, by
`column_groups` and `column_guess`. The result is a `Mapping`, which `column_mapping` reads from a TOML file instead.
`table_streams` fills a `Parsed` according to the `Mapping`. Readers of known columns, such as those of Sensor Logger,
ROS and RoNIN, fill a `Parsed` themselves. `Parsed.recording()` returns the `Recording`.
"""
