"""Tables of any app: text, JSON, spreadsheets and MATLAB, with named or guessed columns."""
