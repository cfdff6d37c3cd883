/** A map as a component: the map, its buttons, and the layers that its page gives. */
import type { ComponentChildren } from "preact";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { useTheme } from "../ui";
import { ATTRIBUTION, background } from "./background";
import type { Layer, LonLat } from "./layers";
import { type MapOptions, MapView } from "./view";

interface MapProps extends MapOptions {
  label: string;
  layers: Layer[];
  /** The points to keep in view until the user moves the map. */
  frame: LonLat[];
  /** Changes with the subject of `frame`. The map then shows the new points. */
  frameKey: string;
  /** The least extent of the map (m). */
  smallestM: number;
  /** Draw a grid in metres from this point instead of meridians and parallels. */
  anchor?: LonLat;
  children?: ComponentChildren;
}

export function Map2d({ label, layers, frame, frameKey, smallestM, anchor, children, ...options }: MapProps) {
  const theme = useTheme();
  const box = useRef<HTMLDivElement>(null);
  const target = useRef<HTMLDivElement>(null);
  const map = useRef<MapView | null>(null);
  const framed = useRef("");
  const below = useMemo(() => background(anchor), [anchor?.lon, anchor?.lat, theme]);

  useEffect(() => {
    if (!box.current || !target.current) return undefined;
    const made = new MapView(box.current, target.current);
    map.current = made;
    return () => made.remove();
  }, []);
  useEffect(() => {
    if (map.current) map.current.options = options;
  });
  useEffect(() => map.current?.showBelow(below), [below]);
  useEffect(() => map.current?.show(layers), [layers]);
  useEffect(() => {
    map.current?.frame(frame, smallestM, framed.current !== frameKey);
    if (frame.length) framed.current = frameKey;
  }, [frame, frameKey]);

  return (
    <div class="map" ref={box} tabIndex={0} role="region" aria-label={`${label}. Arrow keys move, plus and minus zoom, 0 shows all.`}>
      <div class="map-canvas" ref={target} />
      <div class="map-buttons">
        <button type="button" aria-label="Zoom in" title="Zoom in (+)" onClick={() => map.current?.zoom(1)}>+</button>
        <button type="button" aria-label="Zoom out" title="Zoom out (−)" onClick={() => map.current?.zoom(-1)}>−</button>
        <button type="button" aria-label="Show all" title="Show all (0)" onClick={() => map.current?.fit()}>⤢</button>
      </div>
      {ATTRIBUTION && <p class="map-attribution">{ATTRIBUTION}</p>}
      {children}
    </div>
  );
}
