"""The page for operators: a subscriber that shows the state of the machines in a browser.

It signs commands of users whose keys its settings name.
"""
