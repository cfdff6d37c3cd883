/** A map as a component: canvas, buttons, and the layers that its page gives. */
import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { ATTRIBUTION } from "./tiles";
import { type Layer, type LonLat, MapCanvas, type MapOptions } from "./view";

interface MapProps extends MapOptions {
  label: string;
  layers: Layer[];
  /** What to show whole until the user moves the map. */
  frame: LonLat[];
  /** Changes when the frame is another thing, so that it is shown again. */
  frameKey: string;
  /** The least extent of the map (m). */
  smallestM: number;
  children?: ComponentChildren;
}

export function Map2d(props: MapProps) {
  const box = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const map = useRef<MapCanvas | null>(null);
  const framed = useRef<{ key: string; frame: LonLat[] }>({ key: "", frame: [] });

  useEffect(() => {
    if (!box.current || !canvas.current) return undefined;
    const made = new MapCanvas(box.current, canvas.current, {});
    map.current = made;
    return () => made.remove();
  }, []);

  useEffect(() => {
    const { current } = map;
    if (!current) return;
    const { anchor, onPick, onHover, calmWheel } = props;
    current.options = { anchor, onPick, onHover, calmWheel };
    if (props.frame !== framed.current.frame) {
      current.frameOn(props.frame, props.smallestM, framed.current.key !== props.frameKey);
      if (props.frame.length) framed.current = { key: props.frameKey, frame: props.frame };
    }
    current.show(props.layers);
  });

  return (
    <div class="map" ref={box} tabIndex={0} role="region" aria-label={`${props.label}. Arrow keys move, plus and minus zoom, 0 shows all.`}>
      <canvas ref={canvas} aria-hidden="true" />
      <div class="map-buttons">
        <button type="button" aria-label="Zoom in" title="Zoom in (+)" onClick={() => map.current?.zoom(1.8)}>+</button>
        <button type="button" aria-label="Zoom out" title="Zoom out (−)" onClick={() => map.current?.zoom(1 / 1.8)}>−</button>
        <button type="button" aria-label="Show all" title="Show all (0)" onClick={() => map.current?.fit()}>⤢</button>
      </div>
      {ATTRIBUTION && <p class="map-attribution">{ATTRIBUTION}</p>}
      {props.children}
    </div>
  );
}
