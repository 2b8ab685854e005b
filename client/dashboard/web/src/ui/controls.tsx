// SPDX-License-Identifier: Apache-2.0
// Small parts that everything else is made of.
import type { ComponentChildren, JSX } from "preact";
import { useEffect, useId, useRef } from "preact/hooks";
import { Icon, type IconName } from "./icons";

export function IconButton(props: {
  icon: IconName;
  label: string;
  shortcut?: string;
  pressed?: boolean;
  filled?: boolean;
  tone?: "bad";
  disabled?: boolean;
  onClick: () => void;
}): JSX.Element {
  const title = props.shortcut ? `${props.label} (${props.shortcut})` : props.label;
  return (
    <button
      type="button"
      class="icon-button"
      data-tone={props.tone}
      aria-label={props.label}
      aria-pressed={props.pressed}
      title={title}
      disabled={props.disabled}
      onClick={props.onClick}
    >
      <Icon name={props.icon} filled={props.filled ?? false} />
    </button>
  );
}

export function Button(props: {
  children: ComponentChildren;
  icon?: IconName;
  kind?: "primary" | "danger" | "plain";
  disabled?: boolean;
  type?: "button" | "submit";
  label?: string;
  onClick?: () => void;
}): JSX.Element {
  return (
    <button
      type={props.type ?? "button"}
      class="button"
      data-kind={props.kind ?? "plain"}
      aria-label={props.label}
      disabled={props.disabled}
      onClick={props.onClick}
    >
      {props.icon ? <Icon name={props.icon} /> : null}
      {props.children}
    </button>
  );
}

// One of several; arrow keys move as in a radio group.
export function Segmented<T extends string>(props: {
  label: string;
  value: T;
  options: readonly { value: T; label: string; icon?: IconName; title?: string }[];
  onChange: (value: T) => void;
}): JSX.Element {
  return (
    <div class="segmented" role="group" aria-label={props.label}>
      {props.options.map((o) => (
        <button
          type="button"
          key={o.value}
          aria-pressed={o.value === props.value}
          aria-label={o.icon ? o.label : undefined}
          title={o.title ?? o.label}
          onClick={() => props.onChange(o.value)}
        >
          {o.icon ? <Icon name={o.icon} /> : o.label}
        </button>
      ))}
    </div>
  );
}

export function Dot({ tone }: { tone: string }): JSX.Element {
  return <span class="dot" data-tone={tone} aria-hidden="true" />;
}

export function Meter({ value, label }: { value: number; label: string }): JSX.Element {
  const percent = Math.round(100 * Math.min(1, Math.max(0, value)));
  return (
    <div class="meter" role="meter" aria-label={label} aria-valuemin={0} aria-valuemax={100} aria-valuenow={percent}>
      <div class="meter-bar" style={{ width: `${percent}%` }} />
    </div>
  );
}

export function ProgressBar({ value, label }: { value: number | null; label: string }): JSX.Element {
  return (
    <div
      class="progress"
      role="progressbar"
      aria-label={label}
      aria-valuemin={0}
      aria-valuemax={100}
      aria-valuenow={value === null ? undefined : Math.round(100 * value)}
    >
      <div
        class={value === null ? "progress-bar unknown" : "progress-bar"}
        style={value === null ? {} : { width: `${100 * value}%` }}
      />
    </div>
  );
}

// A modal window over the page; Escape and the backdrop close it.
export function Dialog(props: {
  title: string;
  wide?: boolean;
  onClose: () => void;
  children: ComponentChildren;
  footer?: ComponentChildren;
}): JSX.Element {
  const ref = useRef<HTMLDialogElement>(null);
  const id = useId();
  useEffect(() => {
    const dialog = ref.current!;
    dialog.showModal();
    return () => dialog.close();
  }, []);
  return (
    <dialog
      ref={ref}
      class={props.wide ? "dialog wide" : "dialog"}
      aria-labelledby={id}
      onCancel={(event) => {
        event.preventDefault();
        props.onClose();
      }}
      onClick={(event) => {
        if (event.target === ref.current) props.onClose();
      }}
    >
      <div class="dialog-body">
        <header class="dialog-head">
          <h2 id={id}>{props.title}</h2>
          <IconButton icon="close" label="Close" onClick={props.onClose} />
        </header>
        <div class="dialog-content">{props.children}</div>
        {props.footer ? <footer class="dialog-foot">{props.footer}</footer> : null}
      </div>
    </dialog>
  );
}

export function Field(props: { label: string; hint?: string; children: (id: string) => JSX.Element }): JSX.Element {
  const id = useId();
  return (
    <div class="field">
      <label for={id}>{props.label}</label>
      {props.children(id)}
      {props.hint ? <p class="hint">{props.hint}</p> : null}
    </div>
  );
}

export function Empty(props: { icon: IconName; title: string; children?: ComponentChildren }): JSX.Element {
  return (
    <div class="empty">
      <Icon name={props.icon} />
      <p class="empty-title">{props.title}</p>
      {props.children}
    </div>
  );
}
