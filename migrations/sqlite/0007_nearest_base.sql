-- How a session's base is chosen: 0 it is the one in `base`, if any; 1 the nearest of those in
-- `session_bases`; 2 the nearest of all.
ALTER TABLE sessions ADD COLUMN base_choice INTEGER NOT NULL DEFAULT 0;

-- The bases of which a session takes the nearest, in the order in which they were named.
CREATE TABLE session_bases (
    session INTEGER NOT NULL REFERENCES sessions (key),
    place   INTEGER NOT NULL,
    base    INTEGER NOT NULL REFERENCES bases (key),
    PRIMARY KEY (session, place)
);
CREATE INDEX sessions_of_bases ON session_bases (base);

-- Whether a stream was found in a caster's sourcetable and is asked for while a rover needs it: 0 or 1.
ALTER TABLE base_feeds ADD COLUMN on_demand INTEGER NOT NULL DEFAULT 0;
