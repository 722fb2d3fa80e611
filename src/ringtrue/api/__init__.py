"""The public functions behind `import ringtrue as rt`, one module a part of the chain.

`models`: decks, modes, responses. `tests`: records, FRFs, identification, files of modes.
`comparison`: correlation. `improvement`: localisation, updating, suspension, damping.
`studies`: test plans, studies and what their stores hold. Users import names from `ringtrue` alone.
"""
