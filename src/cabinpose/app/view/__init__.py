"""Pictures to judge a dataset by: a summary in numbers, a contact sheet, a page to browse frames."""
